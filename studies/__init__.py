"""What runs estimators and the smoother over many recordings, for notebooks and the command line alike."""
