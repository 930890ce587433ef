"""Known answers of films: stretched, inflated and wrinkled."""
