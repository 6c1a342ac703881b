"""The experiments behind ``stillpoint experiment NAME``, one file for each paper."""
