"""What a message of a log contains: calls as blocks, columns of rows, their bytes and hash."""
