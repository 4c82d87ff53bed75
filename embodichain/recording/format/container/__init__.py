"""The file around messages: MCAP's records, archives, and unpacking with limits."""
