"""Recorders of cars, laboratories and sound: MF4, TDMS, UFF, WAV and IDE."""
