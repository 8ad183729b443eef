"""Examples: the gallery, and the blocks and tables of published papers.

Programs of the repository import them from its root, and it runs them with ``python -m``.
"""
