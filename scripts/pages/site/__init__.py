"""Programs that write pages and formulas of the documentation site."""
