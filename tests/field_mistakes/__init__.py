"""Small projects, each with one mistake that people make in the field or at the desk."""
