"""The underwater mission of Zia (2022)."""
