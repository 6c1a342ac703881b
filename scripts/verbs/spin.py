"""``stillpoint spin NAME``: place accelerometers on a spinning body, and identify their noise."""

from cyclopts import App

app = App(name="spin", help="Place accelerometers on a spinning body, and identify their noise.")
app.command(
    "stillpoint.scripts.verbs.spin_design:spin_design",
    name="design",
    help="Accuracy over the lever arms, with the range's limit (Asghari et al. 2018, section 3.2).",
    sort_key=0,
)
app.command(
    "stillpoint.scripts.verbs.spin_identify:spin_identify",
    name="identify",
    help="Noise variances from trials with an encoder (Asghari et al. 2018, eqs (28)-(31)).",
    sort_key=1,
)
