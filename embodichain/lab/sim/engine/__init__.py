"""Engines that step the batch: one interface (`api`), one implementation per device."""
