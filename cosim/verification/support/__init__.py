"""Meshes and specimens that verification cases share."""
