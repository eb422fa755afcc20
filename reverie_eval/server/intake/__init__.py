"""Submissions: from an upload or an e-mailed file to a result, and what is published of it."""
