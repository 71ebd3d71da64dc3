"""The mathematics: arrays in, arrays out; no files, no people, no network."""
