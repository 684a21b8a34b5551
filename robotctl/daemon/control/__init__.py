"""What comes in becomes an event, the kernel decides, and its effects are carried out."""
