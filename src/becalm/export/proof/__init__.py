"""Compile and run exported C, compare it with becalm, and write the certificate."""
