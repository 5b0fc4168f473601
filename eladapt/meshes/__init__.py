"""The triangles in a mesh file: read from its own bytes, never from a file that it names."""
