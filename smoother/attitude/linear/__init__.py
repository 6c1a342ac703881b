"""The linear systems of the graph: as arrays, their structure, their elimination, and covariances."""
