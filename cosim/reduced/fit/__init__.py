"""Section models made from the film that they represent."""
