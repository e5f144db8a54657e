"""What a camera sees of it: loops that turn patches into pixels."""
