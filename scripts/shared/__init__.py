"""The parts that several verbs need: inputs, outputs, tables, batches and jobs."""
