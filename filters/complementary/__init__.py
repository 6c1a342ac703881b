"""Complementary filters, and the single sensors that they blend."""
