"""Checks of results by others: receipts, and what a change does to recorded episodes."""
