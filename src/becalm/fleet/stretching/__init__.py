"""One sensor's endless recording, cut in time: each stretch warms up on what was before, and seams are certified."""
