"""The keys of a robot (`keyring`), and the list of the files that it sealed (`heads`)."""
