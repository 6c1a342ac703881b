"""What recordings, references and estimates become outside of MCAP: tables for CSV, and KML for maps."""
