"""comma2k19 segments as signal logs."""
