"""Building blocks of wings: everything that an experiment needs besides the public names of the laboratory.

Wings and their experiments

    Wing, Selfcheck             head of a wing, and a number that `stickslip doctor` compares
    Experiment, Paper           description of an experiment, and of a paper that it reproduces
    lazy_function, result_of    functions that are imported late; decorator of the class of results
    Quantity, Quantities, Measures, Estimate, estimate, median      tables of quantities, from which outputs follow
    attach                      public names from a stub, imported on first use
    require, install_command, MissingExtraError     optional libraries

Scenarios

    ScenarioBase, ScenarioTable, validate_scenario      classes of scenarios and of their tables
    Positive, NotNegative, Finite, Listed, Several, Sized, Loads, Duration, Seed, Ranks     kinds of values
    LawTable, PackingLaw, allow_laws, make_law, Packing, make_packing       tables of laws and of packings
    Size, require_sizes         limits of memory, before anything is allocated
    law_references, BUILTIN_LAWS        references of a law, table of built-in ones
    require_lammps_for_ranks, ScenarioError     check of the engine, error of an invalid scenario
    LIMITS, STATE               largest sizes, memory of a saved state for each grain [bytes]

Arguments of functions

    checked, check_types, Requirement       validation of arguments by their annotations
    Array, Bodies, Numbers, Result, Series, Values      annotations
    FILLED, NOT_NEGATIVE, POSITIVE, one_of      requirements beside a type: Annotated[int, POSITIVE]
    require_filled, require_index, require_not_negative, require_options, require_positive, require_shape   checks

Runs

    Report, silent, within      progress
    Checkpoint, checkpoint_in, load_or_compute, abandon     parts that are saved and not computed again
    Workers, Member, Task, Realizations, run_realizations, reach, open_device       realizations in parallel
    archive_fields, ArchiveError        fields of a class in an archive
    check_free, write_atomically, check_output, staged_file     files that are complete or absent

Engines and mechanics

    Engine, Leg, Wave, own_engine       engines of runs in legs
    Account, least_supports, volume, body_numbers       ledger of quasi-static steps, rattlers, cell, indices
    evaluate, largest_stiffness, with_values        values, stiffness and parameters of a law
    Scales, compression_scales, check_pressure, servo_mass, settle, strain_step, stopped, SETTLING_DRAG     small steps
    packing_info, solve_point, travel, KICK_LEGS, EVENT_RATIO, clear_round_off      packings, load paths, kicks, events

Numbers and text

    Fields, current_units, heading, in_readable_units, in_units, unit_name, units_of, with_unit, SI, YEAR      units
    readable, pluralize, quoted, shortened      representation of results, and words
    parse_number, parse_integer, read_text      text
    read_table, heading_of, split_label, write_table, format_table       tables

Terminal and command line

    console, new_table, show_table, progress        terminal
    command, examples, Out, Output, FigureOptions, PackingOptions       commands and their options
    number_option, check_choice, complete_from, finish, in_units_of_packing, StoppedError       details of commands

Figures

    styled, subplots, column_axes, label_axes, legend_above, plot_fast, power_of_ten, WIDTH, PAGE       axes and style
    BLACK, BLUE, COLORS, GREEN, ORANGE, PURPLE, RED, SKY        colours
    draw_grains_by_speed, body_limits, APART        grains coloured by speed, and the view of them
    render, render_all, FORMATS, PLAIN      files of figures

Claims of a paper

    Claim, claim, median_error, standard_error, format_value, note_quick_run        rows of the table of claims
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
