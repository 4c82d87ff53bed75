"""Pictures: one contract for N environments and M cameras, drawn in one call."""
