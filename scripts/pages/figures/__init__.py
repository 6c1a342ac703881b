"""Programs that draw figures of docs/figures."""
