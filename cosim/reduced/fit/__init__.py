"""Section models made from the film that they stand for."""
