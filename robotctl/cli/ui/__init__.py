"""What is drawn and printed in a terminal, and the keys that it sends."""
