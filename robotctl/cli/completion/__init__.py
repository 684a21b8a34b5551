"""Shell completion: which words may follow what was typed, and the scripts of the shells."""
