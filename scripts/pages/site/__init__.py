"""What `make docs` writes for the documentation site."""
