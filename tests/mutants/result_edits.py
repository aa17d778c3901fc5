"""Faults in what users see of runs and studies: tables, norms, verdicts, and split dissipation."""

from __future__ import annotations

from mutants.kinds import Tested, tested

__all__ = ["RESULT_EDITS"]

OBSERVERS, LOOP = "swe_sphere/simulation/observers.py", "swe_sphere/simulation/loop.py"
SIMULATION, SUMMARY = "swe_sphere/simulation/simulation.py", "swe_sphere/simulation/summary.py"
SPLIT, STEPPER = "swe_sphere/steppers/split_diffusion.py", "swe_sphere/steppers/stepper.py"
INTEGRALS, REFERENCE = "swe_sphere/io/integrals.py", "swe_sphere/io/reference_solution.py"
ACCESSOR, REGRID = "swe_sphere/analysis/accessor.py", "swe_sphere/analysis/regrid.py"
ROWS, MEASURE = "swe_sphere/studies/cases/rows.py", "swe_sphere/studies/cases/measure.py"
RANKING, RECORD = "swe_sphere/studies/report/ranking.py", "swe_sphere/studies/sweep/record.py"
ENSEMBLE = "swe_sphere/studies/ensemble.py"

_IN_STAGES = "test_edge_penalty.py::test_stages_contain_it_only_where_it_is_not_split"
_WAVES = "test_edge_penalty.py::test_waves_of_any_phase_decay"
_VERDICT = ("test_stress.py::test_what_an_end_is_called",)
_COLUMNS = (
    "test_report_statistics.py::test_columns_are_multiples_of_either_limit_and_counts_per_step",
)
_MEMBERS = ("test_ensemble.py::test_a_spread_is_that_of_the_members",)

SPLITTING = tested(
    "split dissipation",
    (
        "every implicit method holds the edge penalty over a step",
        "swe_sphere/steppers/implicit.py",
        (f"{_IN_STAGES}[plain-esdirk4]",),
        "splits_penalty = False",
        "splits_penalty = True",
    ),
    (
        "bdf2 has the edge penalty in its equations",
        "swe_sphere/steppers/dirk.py",
        (f"{_IN_STAGES}[plain-bdf2]",),
        "splits_penalty, penalised_at = True, 1.0",
        "splits_penalty, penalised_at = False, 1.0",
    ),
    (
        "long steps extrapolate the state in full",
        SPLIT,
        (f"{_WAVES}[tr-bdf2-6.0]",),
        "ahead * min(1.0, math.exp(HELD - reach))",
        "ahead",
    ),
    (
        "long steps hold the initial rate",
        SPLIT,
        (f"{_WAVES}[implicit-euler-6.0]",),
        "if reach <= HELD:",
        "if reach >= 0.0:",
    ),
    (
        "diffusion acts in the stages and apart",
        STEPPER,
        ("test_edge_penalty.py::test_separate_diffusion_leaves_it_in_the_stages[plain-esdirk4]",),
        "return model.without(lambda effect: effect.diffuses) if self.splits_diffusion else model",
        "return model",
    ),
    (
        "a held penalty does not lower the order",
        STEPPER,
        (f"{_IN_STAGES}[plain-sdirk3]",),
        "limited = (model.penalised and cls.splits_penalty) or (apart and model.diffusive)",
        "limited = apart and model.diffusive",
    ),
)

RUNS = tested(
    "run",
    (
        "a rate that is NaN is a fault of the solver",
        OBSERVERS,
        ("test_health.py::test_a_rate_that_is_not_finite_is_no_fault_of_the_solver[ark2]",),
        '("rate of change of the solution", rate)',
        '("rate of change of the solution", state)',
    ),
    (
        "errors of libraries hide a state that is NaN",
        SIMULATION,
        ("test_health.py::test_a_spoilt_state_is_no_fault_of_the_solver[0-h-tr-bdf2]",),
        "if isinstance(error, SolverFailed) or self.comm.size == 1:",
        "if isinstance(error, SolverFailed):",
    ),
    (
        "diagnostics that a restart lost are not reported",
        SIMULATION,
        ("test_kept_series.py::test_a_resumed_run_reports_diagnostics_that_it_does_not_compute",),
        "resumed.diagnostics - DIAGNOSTICS.keys()",
        "resumed.diagnostics - resumed.diagnostics",
    ),
    (
        "the step is blamed for what a callback changed",
        LOOP,
        ("test_health.py::test_a_callback_that_spoils_the_state_is_named",),
        "self.health.observe(self.sim.snapshot, observer)",
        "self.health.observe(self.sim.snapshot)",
    ),
    (
        "a callback is blamed for all later faults",
        OBSERVERS,
        ("test_health.py::test_a_callback_that_left_a_sound_state_is_not_blamed_for_later_faults",),
        "self._space.norm(state), changed_by\n",
        'self._space.norm(state), changed_by or getattr(self, "_changed_by", None)\n',
    ),
    (
        "forcing since the start counts at each check",
        OBSERVERS,
        (
            "test_health.py::test_what_forcing_can_add_is_the_same_however_often_the_state_is_checked",
        ),
        "span = (time - self._time) / parts",
        "span = time / parts",
    ),
    (
        "a reference may be a day off the end",
        REFERENCE,
        ("test_going_on.py::test_a_reference_is_of_the_end_of_the_run",),
        "abs(self.times[-1] - time) <= 1.0",
        "abs(self.times[-1] - time) <= DAY",
    ),
    (
        "drifts are relative to the state of the first sample",
        SIMULATION,
        ("test_simulation.py::test_settings_reach_scene_and_effects",),
        "        start = self.initial_fields\n        masses",
        "        start = self.snapshot.all_fields\n        masses",
    ),
    (
        "a restart inherits the time limit",
        "swe_sphere/simulation/restart.py",
        ("test_inherited.py::test_each_field_is_known_to_be_inherited_or_not",),
        '"reference", "time_limit", "trust"',
        '"reference", "trust"',
    ),
    (
        "a refused run has failed",
        SUMMARY,
        ("test_going_on.py::test_a_table_in_a_notebook_states_why_a_run_stopped",),
        '"refused" if exit_status == 2 else "failed"',
        '"failed"',
    ),
    (
        "speed in the log counts days before a restart",
        OBSERVERS,
        ("test_cli.py::test_the_log_of_a_resumed_run_counts_its_own_days_alone",),
        "speed = (at - self._from) / gone",
        "speed = at / gone",
    ),
)

FILES = tested(
    "file",
    (
        "samples after the last frame of a store lost",
        "swe_sphere/io/growing.py",
        ("test_zarr.py::test_a_store_holds_what_a_file_holds",),
        "        self._append_samples()\n        attributes =",
        "        attributes =",
    ),
    (
        "a long summary loses its beginning",
        "swe_sphere/io/netcdf.py",
        ("test_netcdf.py::test_a_summary_that_is_too_long_loses_its_end",),
        "kept.popitem()",
        "kept.pop(next(iter(kept)))",
    ),
    (
        "potential vorticity without the Coriolis parameter",
        "swe_sphere/io/scalar_fields.py",
        ("test_netcdf.py::test_derived_fields_have_the_values_of_their_formulas",),
        '(derive(fields, "vorticity") + derive(fields, "f"))',
        'derive(fields, "vorticity")',
    ),
    (
        "drifts of the angular momentum relative to each component",
        INTEGRALS,
        ("test_angular_momentum.py::test_the_drift_is_relative_to_the_vector",),
        "**dict.fromkeys(MOMENTA, math.hypot(*(start[name] for name in AXES)))",
        "**{}",
    ),
    (
        "drifts of tracers absolute",
        INTEGRALS,
        ("test_norms.py::test_drifts_of_tracers_are_relative",),
        "(mass - first) / first if first",
        "mass - first if first",
    ),
    (
        "fraction of the day of a reference cut",
        REFERENCE,
        ("test_reference.py::test_the_title_of_a_reference_states_a_fraction_of_a_day",),
        r'r"day (\d+(?:\.\d+)?)"',
        r'r"day (\d+)"',
    ),
    (
        "winds of references keep their sign across the poles",
        REFERENCE,
        ("test_reference.py::test_a_grid_is_evaluated_anywhere",),
        "self(u, -1.0), self(v, -1.0)",
        "self(u), self(v)",
    ),
    (
        "correlation without weights",
        REFERENCE,
        ("test_reference.py::test_the_correlation_is_that_over_the_sphere",),
        ", aweights=self._reference.area",
        "",
    ),
    (
        "files compared at the first common time",
        REFERENCE,
        ("test_reference.py::test_the_same_state_on_two_meshes",),
        "float(common[-1])",
        "float(common[0])",
    ),
    (
        "files compared without weights",
        REFERENCE,
        ("test_reference.py::test_files_are_compared_with_weights_of_areas",),
        "**norms(theirs.area, found",
        "**norms(1.0 + 0.0 * theirs.area, found",
    ),
)

ANALYSIS = tested(
    "analysis",
    (
        "error norms without weights",
        ACCESSOR,
        ("test_analysis.py::test_errors_between_runs_are_weighted_with_areas",),
        "norms(theirs.area, evaluate",
        "norms(1.0 + 0.0 * theirs.area, evaluate",
    ),
    (
        "integrals with the gravity of the Earth",
        ACCESSOR,
        ("test_analysis.py::test_potential_vorticity_and_integrals",),
        "planet = Planet(**(json.loads(given) if isinstance(given, str) else given))",
        "planet = Planet()",
    ),
    (
        "decoded times in minutes",
        "swe_sphere/io/layout.py",
        ("test_analysis.py::test_times_that_xarray_has_decoded_are_seconds_again",),
        'np.timedelta64(1, "s")',
        'np.timedelta64(1, "m")',
    ),
    (
        "bounds of longitude half a cell off",
        REGRID,
        ("test_analysis.py::test_points_of_a_grid_lie_within_the_bounds_of_their_cells",),
        "west = -0.5 * float(grid.lon[1])",
        "west = 0.0",
    ),
    (
        "frames with missing values are regridded",
        REGRID,
        ("test_analysis.py::test_a_frame_with_missing_values_is_not_regridded",),
        "read_values(path, str(name), frame[name].variable)",
        "pass",
    ),
)

STUDIES = tested(
    "study",
    (
        "an unstable run counts as refused",
        ROWS,
        _VERDICT,
        '"refused": "refused"}.get(status, "stopped")',
        '"refused": "refused"}.get(status, "refused")',
    ),
    (
        "a stopped run passes all bounds",
        ROWS,
        _VERDICT,
        "if (x.always or not stopped) and not x.holds",
        "if not stopped and not x.holds",
    ),
    (
        "orders per doubling of np, not of np - 1",
        ROWS,
        ("test_verify.py::test_an_order_is_per_doubling_of_elements_degree_or_steps[np-values1]",),
        '"np": np - 1,',
        '"np": np,',
    ),
    (
        "undershoots of tracers not counted",
        MEASURE,
        ("test_stress.py::test_undershoots_of_tracers_count_as_overshoots_do",),
        "max(*under, *over)",
        "max(over)",
    ),
    (
        "growth of errors three times as large",
        MEASURE,
        ("test_stress.py::test_growth_of_errors",),
        "late / (3.0 * early)",
        "late / early",
    ),
    (
        "gain of energy is its largest loss",
        MEASURE,
        ("test_stress.py::test_a_filter_of_the_wrong_sign_fails",),
        'of["energy_drift"].max()',
        'of["energy_drift"].min()',
    ),
    (
        "shortest times have no uncertainty",
        RANKING,
        ("test_report_statistics.py::test_how_far_a_time_is_known",),
        "least=cost / known",
        "least=cost",
    ),
    (
        "multiples of the wrong limit",
        RANKING,
        _COLUMNS,
        'advective_multiple=runs["dt"] / advective',
        'advective_multiple=runs["dt"] / gravity',
    ),
    (
        "Newton iterations in the column of Krylov's",
        RANKING,
        _COLUMNS,
        'krylov_a_step=runs["krylov_iterations"]',
        'krylov_a_step=runs["newton_iterations"]',
    ),
    (
        "the first untimed run in the place of the longest step",
        RANKING,
        ("test_report_statistics.py::test_runs_that_were_not_timed_have_errors_and_no_rank",),
        '.sort_values("dt", ascending=False, kind="stable")',
        "",
    ),
    (
        "error of the coarser converged run",
        RECORD,
        (
            "test_sweep_parts.py::test_the_stated_error_of_converged_runs_is_the_largest_of_all_meshes",
        ),
        "min(finest.get(mesh, here), here)",
        "max(finest.get(mesh, here), here)",
    ),
    (
        "error of the converged run of the best mesh",
        RECORD,
        (
            "test_sweep_parts.py::test_the_stated_error_of_converged_runs_is_the_largest_of_all_meshes",
        ),
        "max(finest.values(), key=lambda",
        "min(finest.values(), key=lambda",
    ),
    (
        "a repeat that was cut short is the fastest",
        RECORD,
        ("test_sweep.py::test_a_repeat_that_was_cut_short_is_not_the_time_of_the_run",),
        'kept = (table.index.get_level_values("repeat") == 0) | (table["status"] == "completed")',
        'kept = table["status"] != ""',
    ),
    (
        "a search for the error in time where the total one is known",
        "swe_sphere/studies/sweep/runs.py",
        ("test_sweep.py::test_a_search_is_for_the_total_error_where_it_is_known",),
        '"total" if "total" in found else "time"',
        '"time"',
    ),
    (
        "the key of a run does not depend on its references",
        "swe_sphere/studies/sweep/runs.py",
        ("test_sweep_stores.py::test_runs_of_a_scene_whose_base_has_changed_are_made_again",),
        "study.error_identity(self.role), of.sources",
        "of.sources",
    ),
    (
        "advice from a shorter run at the error of the whole",
        "swe_sphere/studies/advise.py",
        ("test_advise.py::test_where_the_budget_is_short_shorter_runs_are_measured",),
        "question.error * days / whole",
        "question.error",
    ),
    (
        "growth of a spread in decades",
        ENSEMBLE,
        _MEMBERS,
        "np.log(positive)",
        "np.log10(positive)",
    ),
    (
        "spread without weights",
        ENSEMBLE,
        _MEMBERS,
        "area_mean(mesh.area, each)",
        "area_mean(1.0 + 0.0 * mesh.area, each)",
    ),
    (
        "a member with another step counts as the same",
        ENSEMBLE,
        _MEMBERS,
        'FREE = ("overwrite", ',
        'FREE = ("dt", "overwrite", ',
    ),
)

RESULT_EDITS: tuple[Tested, ...] = (*SPLITTING, *RUNS, *FILES, *ANALYSIS, *STUDIES)
"""All of them."""
