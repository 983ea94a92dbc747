"""From a Gram matrix to a posterior: the Gram matrix, the prior, and engines, which the table `engines` lists."""
