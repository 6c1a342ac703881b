"""The experiments of the four papers, one folder for each."""
