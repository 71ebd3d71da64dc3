"""A settled gain after a table of gains: no covariance, no division."""
