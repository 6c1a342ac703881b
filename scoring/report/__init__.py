"""HTML pages about one recording, with their figures and templates."""
