"""C compiled, run, compared with becalm; and the certificate."""
