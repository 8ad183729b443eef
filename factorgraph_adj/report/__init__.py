"""Reports of an adjustment and of two epochs: protocols, tables, pages and figures."""
