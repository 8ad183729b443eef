"""Reports of adjustments and of two epochs as HTML files that people open (extra ``report``).

The page is made by a template of jinja2. Plotly draws plan, 3-D view and statistics, DataTables (as
itables packs it) sorts, filters and exports tables. Both libraries and all data stand packed in the
file: nothing is fetched from anywhere, and what is heavy is unpacked when it is looked at.
"""
