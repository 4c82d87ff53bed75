"""What a log is made of: records, messages, columns, parts; written and read alike."""
