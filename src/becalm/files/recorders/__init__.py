"""Read and write files of recorders in cars, laboratories and sound: MF4, TDMS, UFF, WAV and IDE."""
