"""What all packages may use: errors, paths, files and trust, text, processes, domains, stores."""
