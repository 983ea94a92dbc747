"""From a Gram matrix to a posterior: the matrix, and engines, of which `engines` is the table."""
