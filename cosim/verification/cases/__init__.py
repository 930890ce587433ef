"""Known answers of equilibria of strips, cables, tubes and gas."""
