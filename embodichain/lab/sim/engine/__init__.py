"""What steps the batch: one contract (`api`), one implementation a device."""
