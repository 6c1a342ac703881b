"""What lies between the windows of a long recording: what one hands over, and how solved ones are kept."""
