"""Search of worst cases: `falsify.falsify`."""
