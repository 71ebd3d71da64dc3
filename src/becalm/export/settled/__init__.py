"""Export a filter with a table of gains and then a settled gain, without covariance or division."""
