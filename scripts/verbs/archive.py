"""``stillpoint archive``: keep, find, verify and publish datasets."""

from cyclopts import App

app = App(name="archive", help="Keep, find, verify and publish recordings, references, estimates and scores.")
for _place, (_name, _target, _help) in enumerate(
    (
        ("init", "keep:init", "Make an archive in a new folder."),
        ("add", "keep:add", "Keep files in the archive."),
        ("tag", "keep:tag", "Give objects tags and metadata."),
        ("remove", "keep:remove", "Mark objects as removed; gc deletes their bytes later."),
        ("gc", "keep:gc", "Delete the bytes of objects that were removed some time ago."),
        ("find", "find:find", "Find objects by their facts, tags and metadata."),
        ("list", "find:list_", "List everything in the archive."),
        ("show", "find:show", "Show one object: facts, what it was made from, what was made from it, scores."),
        ("verify", "check:verify", "Read everything, and list what is wrong and how to repair it."),
        ("repair", "check:repair", "Mend damaged objects from a copy, and damaged records."),
        ("rebuild", "check:rebuild", "Make the catalogue again from the objects."),
        ("export", "publish:export", "Write a bundle for Zenodo or Hugging Face, with all metadata."),
        ("import", "publish:import_", "Take such a bundle into the archive."),
        ("bundle", "publish:bundle", "Write a recording with its reference and estimates as one MCAP file."),
    )
):
    app.command(f"stillpoint.scripts.verbs.archives.{_target}", name=_name, help=_help, sort_key=_place)
