"""Programs that write tables and figures into docs/."""
