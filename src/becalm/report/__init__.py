"""The report: what was done to a recording, in pictures and words."""
