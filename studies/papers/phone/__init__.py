"""The phone experiments of Elmi Aziz and Mohseni Araste (2021)."""
