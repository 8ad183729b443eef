"""Planning before measuring: precision and reliability of a design, and proposals of additions."""
