"""A batch in shards: parts of it run elsewhere, and `ShardedEnv` joins them into one."""
