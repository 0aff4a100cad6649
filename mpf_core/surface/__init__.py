"""From the field to a mesh that people can use."""
