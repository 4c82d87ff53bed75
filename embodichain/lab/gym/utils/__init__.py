"""Around environments: registration, launcher arguments, spaces."""
