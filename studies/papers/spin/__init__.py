"""The spinning-body experiments of Asghari et al. (2018)."""
