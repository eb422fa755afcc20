"""HTTP around the routes: limits, headers, errors, logging and metrics."""
