"""Faults in what is tied to the step: tolerances, steps of other lengths, and what files tell."""

from __future__ import annotations

from mutants.kinds import tested

__all__ = ["STEP_EDITS"]

STEPPERS = "swe_sphere/steppers"
MOTION, BDF2 = f"{STEPPERS}/stage_solver.py", f"{STEPPERS}/dirk.py"

_TRUNCATION = "test_motion.py::test_solver_is_given_a_part_of_what_the_step_is_wrong_by"
_MIDPOINT, _OF_BDF2 = (f"{_TRUNCATION}[implicit-midpoint]",), (f"{_TRUNCATION}[bdf2]",)
_DEFAULTS = "test_motion.py::test_default_tolerance_leaves_the_error_that_of_the_scheme"
_CAP = ("test_motion.py::test_steps_that_do_not_resolve_the_motion_have_no_larger_tolerance",)
_RATES = (
    "test_motion.py::test_rate_and_frequency_are_divided_differences_whatever_the_steps",
    "test_motion.py::test_motion_goes_on_from_what_it_remembers",
)
_PARABOLA = ("test_variable_steps.py::test_schemes_of_second_order_follow_a_parabola[bdf2]",)
_GUESSES = ("test_variable_steps.py::test_guesses_are_solutions_where_the_state_moves_straight_on",)
_SHARED = ("test_motion.py::test_semi_implicit_schemes_have_the_constants_of_their_parts",)
_RESTART = ("test_implicit.py::test_restart_is_exact_to_the_last_bit[bdf2]",)
_CONVENTIONS = ("test_netcdf.py::test_conventions",)
_OTHER_RUN = ("test_netcdf.py::test_a_checkpoint_left_behind_by_another_run_is_not_taken",)
_CHECKPOINT = ("test_simulation.py::test_a_checkpoint_stands_where_the_last_frame_does[rk4]",)
_CONTINUED = ("test_simulation.py::test_a_restart_goes_on_bit_for_bit[rk4-settings0]",)
_HALVED = (
    "test_dissipation.py::test_hyperviscosity_by_default_is_ten_times_less_for_half_the_spacing",
)

TOLERANCE = tested(
    "tolerance",
    ("share of the truncation error × 10", MOTION, _MIDPOINT, "SHARE = 0.45", "SHARE = 4.5"),
    ("one power of the step less", MOTION, _MIDPOINT, "** (order - 1)", "** (order - 2)"),
    ("error constant of BDF2 × 10", BDF2, _OF_BDF2, "2.0 / 9.0", "20.0 / 9.0"),
    (
        "error constants of Runge-Kutta methods of an order too low",
        f"{STEPPERS}/stability.py",
        _MIDPOINT,
        "matrix_power(a, order)",
        "matrix_power(a, order - 1)",
    ),
    (
        "error constant of semi-implicit leapfrog × 10",
        f"{STEPPERS}/leapfrog.py",
        _SHARED,
        "error_constant = 1.0 / 6.0",
        "error_constant = 10.0 / 6.0",
    ),
    ("no cap for long steps", MOTION, _CAP, "(min(1.0, f * dt) for f", "(f * dt for f"),
    (
        "default of Gauss-Legendre × 10",
        f"{STEPPERS}/gauss.py",
        (f"{_DEFAULTS}[gauss-legendre]",),
        "default_tolerance = 1e-4",
        "default_tolerance = 1e-3",
    ),
    (
        "default of BDF2 × 10",
        BDF2,
        (f"{_DEFAULTS}[bdf2]",),
        'default_tolerance = 1e-2\n    memory = "state", "previous"',
        'default_tolerance = 1e-1\n    memory = "state", "previous"',
    ),
    (
        "default of implicit schemes × 10",
        f"{STEPPERS}/stepper.py",
        (f"{_DEFAULTS}[crank-nicolson]",),
        "default_tolerance: ClassVar[float] = 1e-3",
        "default_tolerance: ClassVar[float] = 1e-2",
    ),
)

VARIABLE_STEP = tested(
    "variable step",
    (
        "BDF2: weight of the present",
        BDF2,
        _PARABOLA,
        "axpby(1.0, self.state, w**2",
        "axpby(1.0 + 0.02 * (w - 1.0), self.state, w**2",
    ),
    (
        "BDF2: weight of the past",
        BDF2,
        _PARABOLA,
        "w**2 / (1.0 + 2.0 * w), self._rhs",
        "w**2 / (1.0 + 2.0 * w) + 0.02 * (w - 1.0), self._rhs",
    ),
    (
        "BDF2: weight of the slope",
        BDF2,
        _PARABOLA,
        "dt * (1.0 + w) / (1.0 + 2.0 * w), t + dt",
        "dt * ((1.0 + w) / (1.0 + 2.0 * w) + 0.02 * (w - 1.0)), t + dt",
    ),
    (
        "BDF2: guess as for equal steps",
        BDF2,
        _GUESSES,
        "combine(self.state, slope, dt, curvature",
        "combine(self.state, slope, before, curvature",
    ),
    (
        "Gauss-Legendre: slopes of the outer step",
        f"{STEPPERS}/gauss.py",
        _GUESSES,
        "(INVERSE / dt).tolist()",
        "(INVERSE / self.dt).tolist()",
    ),
    ("distance of slopes", MOTION, _RATES, "apart = 0.5 * (dt + self.last_dt)", "apart = dt"),
    (
        "the last step of the motion lost in restarts",
        MOTION,
        _RATES,
        "self.rate, self.last_dt, first, second = saved",
        "self.rate, _, first, second = saved",
    ),
    (
        "the last step of BDF2 lost in restarts",
        MOTION,
        _RESTART,
        "self.rate, self.last_dt, first, second = saved",
        "self.rate, _, first, second = saved",
    ),
)

METADATA = tested(
    "metadata",
    (
        "steps of checkpoints one too few",
        "swe_sphere/simulation/observers.py",
        _CHECKPOINT,
        "checkpoint(arrays, steps)",
        "checkpoint(arrays, steps - 1)",
    ),
    (
        "one run_id for all runs",
        "swe_sphere/io/netcdf.py",
        _OTHER_RUN,
        "uuid.uuid4().hex",
        "uuid.NAMESPACE_URL.hex",
    ),
    (
        "times in hours",
        "swe_sphere/io/layout.py",
        _CONVENTIONS,
        'f"seconds since {START}',
        'f"hours since {START}',
    ),
    (
        "calendar without leap years",
        "swe_sphere/io/layout.py",
        _CONVENTIONS,
        "proleptic_gregorian",
        "noleap",
    ),
    (
        "counts before a restart forgotten",
        "swe_sphere/simulation/simulation.py",
        _CONTINUED,
        "n + self._earlier_counts.get(name, 0)",
        "n",
    ),
    (
        "default hyperviscosity the same for all np",
        "swe_sphere/equations/effects.py",
        _HALVED,
        "(ne * (np - 1) * refinement)",
        "(ne * 3 * refinement)",
    ),
    (
        "unit of potential enstrophy",
        "swe_sphere/io/variables.toml",
        (
            "test_output_attributes.py::test_variables_have_the_dimensions_and_attributes_of_the_table",
        ),
        'units = "m-1 s-2"\n\n[series.angular_momentum_x]',
        'units = "m s-2"\n\n[series.angular_momentum_x]',
    ),
    (
        "standard name of the northward wind",
        "swe_sphere/io/variables.toml",
        (
            "test_output_attributes.py::test_variables_have_the_dimensions_and_attributes_of_the_table",
        ),
        'standard_name = "northward_wind"',
        'standard_name = "eastward_wind"',
    ),
    (
        "faces numbered from one",
        "swe_sphere/io/variables.toml",
        ("test_netcdf.py::test_conventions",),
        "start_index = 0",
        "start_index = 1",
    ),
    (
        "radius of the sphere left out",
        "swe_sphere/io/layout.py",
        (
            "test_output_attributes.py::test_variables_have_the_dimensions_and_attributes_of_the_table",
        ),
        'topology["sphere"] | {"earth_radius": mesh.radius}',
        'topology["sphere"]',
    ),
    (
        "state checked every 1600 steps",
        "swe_sphere/simulation/observers.py",
        ("test_health.py::test_a_run_that_nothing_observes_ends_soon_after_its_state_is_ruined",),
        "CHECK_STEPS, MOST_FORCING_TIMES = 16, 1000\n",
        "CHECK_STEPS, MOST_FORCING_TIMES = 1600, 1000\n",
    ),
    (
        "a depth of zero passes",
        "swe_sphere/simulation/observers.py",
        ("test_health.py::test_depth_is_checked_from_both_sides_of_zero",),
        "*self._depth)) <= 0.0",
        "*self._depth)) < 0.0",
    ),
    (
        "a negative depth is noticed below -1000 m only",
        "swe_sphere/simulation/observers.py",
        ("test_health.py::test_depth_is_checked_from_both_sides_of_zero",),
        "*self._depth)) <= 0.0",
        "*self._depth)) <= -1000.0",
    ),
    (
        "a restart does not inherit the tolerance",
        "swe_sphere/simulation/restart.py",
        ("test_inherited.py",),
        '*OF_ONE_RUN, "scene",',
        '*OF_ONE_RUN, "tolerance", "scene",',
    ),
    (
        "programs that claim a file at once are not noticed",
        "swe_sphere/files/durable.py",
        ("test_temporary_names.py::test_of_two_programs_that_claim_a_file_at_once_one_gets_it",),
        "_remove_unfinished(path, part)",
        "pass",
    ),
    (
        "energy may grow by the root of its bound more",
        "swe_sphere/simulation/observers.py",
        ("test_health.py::test_energy_is_checked_from_both_sides_of_its_bound",),
        "growth = (norm / self._expected_norm) ** 2",
        "growth = norm / self._expected_norm",
    ),
    (
        "a state that a callback changed is not checked",
        "swe_sphere/simulation/loop.py",
        ("test_health.py::test_a_callback_that_spoils_the_state_ends_the_run",),
        "self.health.observe(self.sim.snapshot, observer)\n",
        "pass\n",
    ),
    (
        "wall time before a change of step counted twice",
        "swe_sphere/simulation/simulation.py",
        ("test_step_changes.py::test_wall_time_is_counted_once_over_a_change_of_step",),
        '        spent["wall_seconds"] -= self.wall_seconds\n',
        "",
    ),
    (
        "sample at the restart written twice",
        "swe_sphere/io/netcdf.py",
        (
            "test_output_attributes.py::test_a_continued_file_keeps_its_beginning_and_has_each_sample_once",
        ),
        "times = times[times < self._from]",
        "times = times[times <= self._from]",
    ),
    (
        "frame at the restart written twice",
        "swe_sphere/io/netcdf.py",
        ("test_going_on.py::test_a_file_is_known_by_its_place_and_not_by_its_name",),
        "frames[frames < self._from]",
        "frames[frames <= self._from]",
    ),
    (
        "a resumed file forgets its history",
        "swe_sphere/io/netcdf.py",
        (
            "test_output_attributes.py::test_a_continued_file_keeps_its_beginning_and_has_each_sample_once",
        ),
        'KEPT = ("run_id", "start_step", "history")',
        'KEPT = ("run_id", "start_step")',
    ),
    (
        "a resumed file begins at the restart",
        "swe_sphere/io/netcdf.py",
        (
            "test_output_attributes.py::test_a_continued_file_keeps_its_beginning_and_has_each_sample_once",
        ),
        'KEPT = ("run_id", "start_step", "history")',
        'KEPT = ("run_id", "history")',
    ),
    (
        "summary of a run that timed out is lost",
        "swe_sphere/simulation/summary.py",
        ("test_simulation.py::test_a_run_that_takes_too_long_ends_in_good_order",),
        '("not begun", "completed", "timed-out", "interrupted")',
        '("not begun", "completed", "interrupted")',
    ),
    (
        "arrays of a checkpoint may be infinite",
        "swe_sphere/simulation/restart.py",
        ("test_hostile_files.py::test_the_arrays_of_a_checkpoint_are_checked",),
        "if not np.isfinite(array).all():",
        "if np.isnan(array).any():",
    ),
    (
        "fingerprints of a restart not compared",
        "swe_sphere/simulation/restart.py",
        ("test_going_on.py::test_a_scene_file_edited_meanwhile_is_not_the_scene",),
        "or before.get(name) != contents",
        "",
    ),
    (
        "a frame up to a day away is taken",
        "swe_sphere/io/runfile.py",
        ("test_initial.py::test_any_frame_is_chosen_by_its_time",),
        "<= TIME_TOLERANCE:\n            days",
        "<= 86400.0:\n            days",
    ),
    (
        "spread over the number of members",
        "swe_sphere/studies/ensemble.py",
        ("test_ensemble.py::test_a_spread_is_that_of_the_members",),
        "axis=0, ddof=1)",
        "axis=0, ddof=0)",
    ),
    (
        "a member of a shorter run counts as finished",
        "swe_sphere/studies/ensemble.py",
        (
            "test_ensemble.py::test_an_ensemble_grows_in_days_and_seeds_and_another_time_limit_is_the_same_run",
        ),
        'if found.get("completed") and before == days:',
        'if found.get("completed"):',
    ),
)

STEP_EDITS = (*TOLERANCE, *VARIABLE_STEP, *METADATA)
"""All of them."""
