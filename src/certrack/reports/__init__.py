"""What is said of results: tables and sentences, the same on the command line and on pages."""
