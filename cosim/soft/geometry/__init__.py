"""Meshes of soft bodies: stacks of polygons, their refinement, their surface."""
