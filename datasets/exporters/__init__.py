"""Turn recordings, references and estimates into tables for CSV and into KML for maps."""
