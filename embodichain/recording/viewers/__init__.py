"""Windows onto a running environment, as observers of its steps."""
