"""Building blocks of wings: everything that an experiment needs besides the public names of the laboratory.

Wings and their experiments

    Wing, Selfcheck, FileFormat     head of a wing, a number that `stickslip doctor` compares, and a format of packings
    Experiment, Paper           description of an experiment, and of a paper that it reproduces
    lazy_function, result_of    functions that are imported late; decorator of the class of results
    attach                      public names from a stub, imported on first use
    require, install_command, MissingExtraError     optional libraries

Scenarios

    ScenarioBase, ScenarioTable, validate_scenario      classes of scenarios and of their tables
    Positive, NotNegative, Finite, Listed, Several, Sized, Loads, Duration, Seed, Ranks     kinds of values
    LawTable, PackingLaw, allow_laws, make_law, Packing, make_packing       tables of laws and of packings
    Size, require_sizes         limits of memory, before anything is allocated
    law_references              references of a law
    require_lammps_for_ranks    check of the engine

Arguments of functions

    checked, check_types, Requirement       validation of arguments by their annotations
    Array, Bodies, Numbers, Result, Series, Values      annotations
    FILLED, NOT_NEGATIVE, POSITIVE, one_of      requirements beside a type: Annotated[int, POSITIVE]
    require_filled, require_index, require_not_negative, require_options, require_positive, require_shape   checks

Runs

    Report, silent, within      progress
    Checkpoint, checkpoint_in, load_or_compute      parts that are saved and not computed again
    Workers, Member, Task, Realizations, run_realizations, open_device      realizations in parallel
    archive_fields, ArchiveError        fields of a class in an archive
    check_free, write_atomically, check_output, staged_file     files that are complete or absent

Numbers and text

    Fields, heading, in_readable_units, in_units, unit_name, units_of, with_unit, SI, YEAR      units
    readable, pluralize, quoted, shortened      representation of results, and words
    parse_number, parse_integer, read_text, read_table, heading_of, write_table, format_table       text and tables

Terminal and command line

    console, new_table, show_table, progress        terminal
    command, examples, Out, Output, FigureOptions, PackingOptions       commands and their options
    number_option, check_choice, complete_from, finish, in_units_of_packing, StoppedError       details of commands

Figures

    styled, subplots, column_axes, label_axes, legend_above, plot_fast, power_of_ten, WIDTH     axes and style
    BLACK, BLUE, COLORS, GREEN, ORANGE, PURPLE, RED, SKY        colours
    draw_grains_by_speed        grains coloured by speed
    render, render_all, FORMATS, PLAIN      files of figures

Claims of a paper

    Claim, claim, median_error, standard_error, format_value, note_quick_run        rows of the table of claims
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
