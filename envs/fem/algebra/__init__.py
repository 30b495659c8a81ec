"""Small vectors, matrices and rows of arrays as kernels use them."""
