"""Files and URLs: atomic writes, remote reads by ranges, and limits on what an input may claim."""
