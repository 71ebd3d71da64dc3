"""Read formats with other libraries, in a subprocess with limits."""
