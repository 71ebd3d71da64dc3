"""A filter that carries its covariance, and may have a gate."""
