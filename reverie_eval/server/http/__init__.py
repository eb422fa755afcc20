"""What stands between the wire and the routes: limits, headers, and a line in the log."""
