"""A film as kernels know it: what most bodies are made of, as arrays, and what its terms add."""
