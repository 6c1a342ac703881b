"""smoother"""
