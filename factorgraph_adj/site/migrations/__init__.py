"""Migrations of the database of a site, by alembic."""
