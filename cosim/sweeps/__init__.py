"""Many runs of one scenario: designs, the executors that run them, one table of what came out."""
