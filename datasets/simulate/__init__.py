"""datasets/simulate"""
