"""datasets/importers"""
