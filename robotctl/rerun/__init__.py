"""Recordings decided once more by a kernel: check, what-if, closed loop, reasons of a stop."""
