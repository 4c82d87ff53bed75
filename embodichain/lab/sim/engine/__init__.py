"""What steps the batch: one contract (`base`), one implementation a device."""
