"""Files: durable writes, Python files of users, fingerprints of code and data."""
