"""Laws side by side: each with gains found by one search, within one set of limits."""
