"""The file of a study: one scenario, and what is varied in it."""
