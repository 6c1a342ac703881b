"""``export_filter``: an estimator with its parameters as one header and one source in C99."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import SpinGeometry
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.filters.c.translate import Function, Translation, wrap_lines
from stillpoint.filters.c.types import Array, CType, Struct, TypeTable, count_reals, parts_of, select_part, type_of
from stillpoint.filters.sample import Sample
from stillpoint.filters.spin.sample import SpinSample
from stillpoint.filters.table import Estimator, SpinEstimator, find_estimator

EXPORTED = ("cf", "cf-fixed", "kf-axis", "ekf", "roll-ekf", "roll-aekf")
_NO_VECTOR = (0.0, 0.0, 0.0)

_LICENCE = """/*
 * {title}
 * Made by stillpoint export-c from the estimator {name}. SPDX-License-Identifier: MIT
 *
 * {units}
 * Define STILLPOINT_SINGLE for single precision. Compile without -ffast-math.
 */
"""
_ATTITUDE_UNITS = """SI units, field in uT. b: body axes. n: East-North-Up. q_nb = (w, x, y, z) rotates b into n.
 * Samples have to be plausible: leave out (NULL) what is saturated or not a number."""
_SPIN_UNITS = (
    """SI units. The two observations are made of the accelerometers as in Asghari et al. 2018, eqs (4), (5), (26)."""
)

_HEADER = """{licence}#ifndef STILLPOINT_{upper}_H
#define STILLPOINT_{upper}_H

#include <stdbool.h>

#ifndef STILLPOINT_REAL
#define STILLPOINT_REAL
#ifdef STILLPOINT_SINGLE
typedef float sp_real;
#else
typedef double sp_real;
#endif
#endif

#ifdef __cplusplus
extern "C" {{
#endif

{types}
/* All that the filter keeps; it may be copied. */
typedef struct {{
    {state} inner;
{arrays}}} {prefix}_filter;

/* Parameters: {settings} */
extern const {coefficients} {prefix}_parameters;

/* Start the filter, or start it again. */
void {prefix}_init({prefix}_filter *filter);

{prototype_comment}
{prototype};

#ifdef __cplusplus
}}
#endif

#endif
"""

_SOURCE = """{licence}#include "{prefix}.h"

#include <math.h>
#include <stddef.h>

#ifdef STILLPOINT_SINGLE
#define REAL(x) ((float)(x))
#define SQRT sqrtf
#define SIN sinf
#define COS cosf
#define EXP expf
#define ATAN2 atan2f
#define FABS fabsf
#define RINT rintf
#else
#define REAL(x) (x)
#define SQRT sqrt
#define SIN sin
#define COS cos
#define EXP exp
#define ATAN2 atan2
#define FABS fabs
#define RINT rint
#endif

const {coefficients} {prefix}_parameters = {values};

{helpers}{functions}
{init}
{update}"""

# Those that a filter needs are kept.
_HELPERS = {
    "min_real(": """static sp_real min_real(sp_real a, sp_real b)
{
    return b < a ? b : a;
}

""",
    "max_real(": """static sp_real max_real(sp_real a, sp_real b)
{
    return b > a ? b : a;
}

""",
    "fill_zeros(": """static sp_real *fill_zeros(sp_real *values, int count)
{
    int i;
    for (i = 0; i < count; i++) {
        values[i] = REAL(0.0);
    }
    return values;
}

""",
}

_ATTITUDE_COMMENT = """/*
 * Take one sample and return whether the attitude is ready.
 * dt_s: since the sample before, 0 for the first; the gyro describes this interval.
 * accel_b_mps2, mag_b_ut: NULL where there is no new one. q_nb: 4 values.
 * bias_b_radps: the gyro's bias, 3 values, or NULL. cov_b_rad2: rows of the attitude's 3 x 3 covariance in body axes,
 * or NULL{no_cov}.
 */"""
_ATTITUDE_PROTOTYPE = """bool {prefix}_update({prefix}_filter *filter, sp_real dt_s, const sp_real gyro_b_radps[3],
    const sp_real *accel_b_mps2, const sp_real *mag_b_ut, sp_real q_nb[4], sp_real *bias_b_radps,
    sp_real *cov_b_rad2)"""
_SPIN_COMMENT = """/*
 * Take one sample and return whether angle and rate are ready.
 * dt_s: since the sample before. accel_radps2: angular acceleration; square_rad2ps2: square of the rate; NULL where
 * missing. direction: +1 or -1 where a sensor shows the sense of the spin, else 0.
 * turns, rest_rad: the angle, whole turns and a rest within half a turn.
 * variances: of the angle, of both, of the rate; or NULL.
 */"""
_SPIN_PROTOTYPE = """bool {prefix}_update({prefix}_filter *filter, sp_real dt_s, const sp_real *accel_radps2,
    const sp_real *square_rad2ps2, int direction, int *turns, sp_real *rest_rad, sp_real *rate_radps,
    sp_real *variances)"""

_ATTITUDE_SAMPLE = """{prefix}_sample sample = {{
    dt_s, {{{{0}}}}, {{{{0}}}}, {{{{0}}}}, accel_b_mps2 != NULL, mag_b_ut != NULL, {{{{0}}}}
}};
for (int i = 0; i < 3; i++) {{
    sample.gyro_b_radps.v[i] = gyro_b_radps[i];
    sample.accel_b_mps2.v[i] = accel_b_mps2 != NULL ? accel_b_mps2[i] : REAL(0.0);
    sample.mag_b_ut.v[i] = mag_b_ut != NULL ? mag_b_ut[i] : REAL(0.0);
}}"""
_SPIN_SAMPLE = """const {prefix}_spin_sample sample = {{
    dt_s,
    accel_radps2 != NULL ? *accel_radps2 : REAL(0.0),
    square_rad2ps2 != NULL ? *square_rad2ps2 : REAL(0.0),
    REAL(1.0),
    REAL(1.0),
    accel_radps2 != NULL,
    square_rad2ps2 != NULL,
    direction,
}};"""


class CSource(NamedTuple):
    """A filter in C; the name of both files without their ending, and their texts."""

    stem: str
    header: str
    source: str


def export_filter(
    name: str,
    params: Settings | Mapping[str, Any] | None = None,
    declination_rad: float = 0.0,
    geometry: SpinGeometry | None = None,
) -> CSource:
    """Return an estimator in C99 with these parameters as constants.

    ``declination_rad`` is east of true north; 0: north is magnetic. ``geometry`` says where the accelerometers of a
    spin sit. Raises :class:`BadParameter` for an estimator that is not among ``EXPORTED``, for unknown parameters, and
    for an estimator of a spin without a geometry.
    """
    if name not in EXPORTED:
        raise BadParameter(f"{name}: cannot be exported to C; choose among {', '.join(EXPORTED)}")
    entry = find_estimator(name)
    settings = choose_settings(entry.params(), params, name)
    if isinstance(entry, SpinEstimator):
        if geometry is None:
            raise BadParameter(f"{name}: follows a spin; say where the accelerometers sit (geometry)")
        c = entry.coefficients(settings, geometry)
    else:
        assert isinstance(entry, Estimator)
        c = entry.coefficients(settings, declination_rad)
    return _write(name, entry, c, settings)


def _write(name: str, entry: Estimator | SpinEstimator, c: Any, settings: Settings) -> CSource:
    """Return both files."""
    prefix = name.replace("-", "_")
    is_spin = isinstance(entry, SpinEstimator)
    state = entry.start(c)
    types = TypeTable(prefix)
    whole = Translation(prefix, types)
    kinds = [type_of(state), type_of(_empty_sample(is_spin)), type_of(c)]
    for kind in kinds:
        types.name(kind)
    step: Any = entry.step
    made = whole.add(step.py_func, kinds)
    arrays = _find_arrays(kinds[0], state, "")
    prototype = (_SPIN_PROTOTYPE if is_spin else _ATTITUDE_PROTOTYPE).format(prefix=prefix)
    update = _write_update(prototype, prefix, types, made, arrays, is_spin)
    functions = "\n".join(whole.bodies)
    shared = {
        "licence": _LICENCE.format(title=entry.summary, name=name, units=_SPIN_UNITS if is_spin else _ATTITUDE_UNITS),
        "prefix": prefix,
        "coefficients": types.name(kinds[2]),
    }
    header = _HEADER.format(
        **shared,
        upper=prefix.upper(),
        types="\n".join(types.definitions),
        state=types.name(kinds[0]),
        arrays="".join(f"    sp_real array{k}[{values.size}];\n" for k, (_, values) in enumerate(arrays)),
        settings=_describe(settings),
        prototype_comment=_comment_update(entry),
        prototype=prototype,
    )
    source = _SOURCE.format(
        **shared,
        values=types.write_value(c),
        helpers="".join(text for call_of, text in _HELPERS.items() if call_of in functions),
        functions=functions,
        init=_write_init(prefix, types.name(kinds[0]), types, state, arrays),
        update=update,
    )
    return CSource(prefix, wrap_lines(header), wrap_lines(source))


def _comment_update(entry: Estimator | SpinEstimator) -> str:
    """Return the comment of the public update."""
    if isinstance(entry, SpinEstimator):
        return _SPIN_COMMENT
    return _ATTITUDE_COMMENT.format(no_cov="" if entry.gives_cov else "; this filter knows none and writes NaN")


def _describe(settings: Settings) -> str:
    """Return the parameters as they are set, in the names of --set."""
    return ", ".join(f"{name} = {value}" for name, value in vars(settings).items())


def _empty_sample(is_spin: bool) -> Sample | SpinSample:
    """Return a sample, for its types."""
    if is_spin:
        return SpinSample(0.0, 0.0, 0.0, 1.0, 1.0, False, False, 0)
    return Sample(0.0, _NO_VECTOR, _NO_VECTOR, _NO_VECTOR, False, False, _NO_VECTOR)


def _find_arrays(kind: CType, value: Any, path: str) -> list[tuple[str, Any]]:
    """Return the arrays in a state: the path of each from the state in C, and its values at the start."""
    if isinstance(kind, Array):
        return [(path, value)]
    if not isinstance(kind, Struct):
        return []
    found = zip(kind.parts, kind.names, strict=True)
    return [
        one
        for k, (part, name) in enumerate(found)
        for one in _find_arrays(part, getattr(value, name), select_part(path, kind, k))
    ]


def _write_init(prefix: str, state_name: str, types: TypeTable, state: Any, arrays: list[tuple[str, Any]]) -> str:
    """Return the function that starts the filter."""
    lines = [f"void {prefix}_init({prefix}_filter *filter)", "{"]
    lines.append(f"    static const {state_name} start = {types.write_value(state)};")
    lines += ["    int i;"] if arrays else []
    lines.append("    filter->inner = start;")
    for k, (_, values) in enumerate(arrays):
        reals = count_reals(values.shape)
        lines += [f"    for (i = 0; i < {reals}; i++) {{", f"        filter->array{k}[i] = REAL(0.0);", "    }"]
        for i in np.flatnonzero(values):
            lines.append(f"    filter->array{k}[{i}] = {types.write_value(float(values.flat[i]))};")
    return "\n".join([*lines, "}", ""])


def _write_update(
    prototype: str, prefix: str, types: TypeTable, made: Function, arrays: list[tuple[str, Any]], is_spin: bool
) -> str:
    """Return the public update: make a sample, call the step, give its output."""
    state, output = parts_of(made.returns)
    assert isinstance(output, Struct)
    storage = [f"sp_real storage[{made.storage}];"] if made.storage else []
    given = f"filter->inner, sample, {prefix}_parameters" + (", storage" if storage else "")
    lines = [
        *storage,
        *(_SPIN_SAMPLE if is_spin else _ATTITUDE_SAMPLE).format(prefix=prefix).splitlines(),
        *(f"filter->inner{path} = filter->array{k};" for k, (path, _) in enumerate(arrays)),
        f"const {types.name(made.returns)} made = step({given});",
        "filter->inner = made.f0;",
        *(_give_spin() if is_spin else _give_attitude(output)),
        "return made.f1.ready;",
    ]
    assert isinstance(state, Struct)
    return "\n".join([prototype, "{", *(f"    {line}" for line in lines), "}", ""])


def _give_attitude(output: Struct) -> list[str]:
    """Return the statements that give attitude, bias and covariance."""
    lines = [f"q_nb[{k}] = made.f1.q_nb.v[{k}];" for k in range(4)]
    for argument, member, count in (("bias_b_radps", "gyro_bias_b_radps", 3), ("cov_b_rad2", "cov_b_rad2", 9)):
        value = f"made.f1.{member}.v[i]" if member in output.names else "(sp_real)NAN"
        lines += [
            f"if ({argument} != NULL) {{",
            f"    for (int i = 0; i < {count}; i++) {{",
            f"        {argument}[i] = {value};",
            "    }",
            "}",
        ]
    return lines


def _give_spin() -> list[str]:
    """Return the statements that give angle, rate and variances."""
    return [
        "*turns = made.f1.motion.turns;",
        "*rest_rad = made.f1.motion.rest_rad;",
        "*rate_radps = made.f1.motion.rate_radps;",
        "if (variances != NULL) {",
        "    variances[0] = made.f1.motion.angle_var;",
        "    variances[1] = made.f1.motion.cross_var;",
        "    variances[2] = made.f1.motion.rate_var;",
        "}",
    ]
