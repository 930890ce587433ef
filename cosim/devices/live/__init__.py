"""Commands from outside, step by step."""
