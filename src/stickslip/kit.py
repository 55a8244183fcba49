"""Building blocks for wings: everything that an experiment needs besides the public names of the laboratory.

Wings and their experiments

    Wing, ExperimentEntry, Command, FileFormat      head of a wing, and its entries
    Selfcheck                   a number that `stickslip doctor` compares
    Experiment, Paper, ScenarioError        description of an experiment, and of a paper; invalid scenario
    Reproduction                result of a paper's scenario, with its claims
    Comparison, SweepMember     comparison of the members of a sweep, and one member
    lazy_function, lazy_functions, result_of        functions that are imported late; decorator of result classes
    Quantity, Quantities, quantities_of, Measures, Estimate, estimate, median      tables of quantities
    attach                      public names from a stub, imported on first use
    require, install_command, MissingExtraError     optional libraries

Scenarios

    ScenarioBase, ScenarioTable, validate_scenario      classes of scenarios and of their tables
    Positive, NotNegative, Finite, Listed, Several, Sized, Loads, Duration, Seed, Ranks     types of values
    LawTable, PackingLaw, allow_laws, make_law, Packing, make_packing       tables of laws and of packings
    Size, require_sizes         limits of memory, before anything is allocated
    LIMITS, STATE               largest sizes; memory of a saved state per grain [bytes]
    law_references              references of a law
    require_lammps_for_ranks    check of the engine

Arguments of functions

    checked, check_types, check_value, knows_bonds, Requirement     validation of arguments by their annotations
    Array, Bodies, Numbers, Result, Series, Values      annotations
    FILLED, NOT_NEGATIVE, POSITIVE, one_of      requirements in addition to a type: Annotated[int, POSITIVE]
    require_filled, require_index, require_not_negative, require_options, require_positive, require_shape   checks

Runs

    Report, silent, within      progress
    Checkpoint, checkpoint_in, load_or_compute, abandon     saved parts of a run
    Workers, Member, Task, Realizations, run_realizations, reach, open_device       realisations in parallel
    archive, archive_fields, ArchiveError, given_keys       archives, their fields, keys of a scenario
    run_files, LEGS, UNFINISHED         names of files and folders within a run folder
    check_free, write_atomically, check_output, staged_file     files written completely or not at all
    find_foreign, foreign_files_message, write_file     folders with other programs' files; files with checksums

States, engines and solvers

    Engine, Leg, Wave, Device, own_engine, take_sample, join_samples    programs that run states
    body_positions, driven_bodies, factors_at, cell_mass, body_numbers  bodies and cells with imposed motion
    with_neighbor_list, resting, reset_reached, shifts, Committed       states and their contact lists
    supports, least_supports, mean_normal_force, natural_scales, clear_round_off, volume    measures that solvers need
    linearise, Linearisation, blocks_of, incidence, spring_stiffness, stiffness_of      linearised contacts
    bond_blocks, bond_limits, bond_motions, bond_rows, bond_vectors, cross_matrix, is_beam      linearised bonds
    bond_crossings, broken_since, judge_loads, with_strength_of, with_weakest_broken        failure of bonds
    linearised, force_imbalance, modes_under, softest_eigenvalue, near_zero, ZERO_BELOW, DENSE_UP_TO     spectra
    core                        compiled functions
    factorised, one_thread, suitable_threads        linear algebra
    Scales, compression_scales, check_pressure, servo_mass, settle, strain_step, stopped, SETTLING_DRAG     slow loading
    equilibrium, bisect_change, dominant_family, Change, Family, Growth, LeftPathError, solve_point     load paths
    PathLedger, packing_info, travel, KICK_LEGS, EVENT_RATIO    ledger along equilibria, packings, kicks, events
    FAILURES, UNBREAKABLE       loads that break bonds, and a strength that no load reaches
    describe_law, to_dict, verdict, no_equilibrium_message      output of `stability`

Contact laws

    BUILTIN_LAWS, BY_NAME, Kind         table of built-in laws; kind of user-defined laws
    builtin                     columns of the table of a law, damping models, properties
    resists_rolling, critical_coefficient, dashpot_coefficients, restitution_of     coefficients of a law
    evaluate, largest_stiffness, with_values        values, stiffness and parameters of a law

LAMMPS files

    lammps_series, Account, MemoryNote  dumps of a running simulation, and notes on their frames
    lammps_laws, lammps_restart, read_dump, wrapped_into        laws, restart files, dumps, positions in a cell

Numbers and text

    Fields, current_units, heading, in_readable_units, in_units, unit_name, units_of, with_unit, SI, YEAR      units
    readable, pluralize, quoted, shortened      results and words in readable form
    parse_number, parse_integer, read_text, decode_text     text
    read_bytes, Budget, check_matlab    bytes of foreign files, within a bound
    laboratory_table            module that reads laboratory tables by the names and units of their columns
    read_table, heading_of, split_label, split_rows, write_table, format_table      tables
    known                       names in foreign files: used, without influence, unknown

Terminal and command line

    console, new_table, show_table, progress, terminal      terminal
    json_output                 JSON output of commands
    command, examples, Out, Output, FigureOptions, PackingFile, PackingOptions      commands and their options
    number_option, check_choice, complete_from, finish, in_units_of_packing, StoppedError       details of commands

Figures

    style                       module that contains the following: axes, style and colours
    styled, subplots, column_axes, label_axes, legend_above, plot_fast, power_of_ten, WIDTH, PAGE       axes and style
    BLACK, BLUE, COLORS, GREEN, ORANGE, PURPLE, RED, SKY        colours
    draw_grains_by_speed        grains coloured by speed
    body_limits, zoomed, outside, outside_words, Zoom, APART, ASIDE     view without grains far from the others
    bare_frame, layout_of, start_drawing, contact_segments      drawings of packings and their contacts
    OwnFigure, common_style, TIME, animation        figures without axes, animations
    page                        HTML pages
    render, render_all, FORMATS, PLAIN      figure files

Claims of a paper

    Claim, claim, statement     rows of the table of claims
    median_error, standard_error, format_value, note_quick_run      errors, values and notes in this table
    ALWAYS, CAN                 kinds of statements: true in every case, possible
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
