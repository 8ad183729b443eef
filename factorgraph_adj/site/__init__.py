"""The site: networks that live for years, their journals in a database, an API and a page."""
