"""Reports of an adjustment and of two epochs: texts, tables, pages and figures."""
