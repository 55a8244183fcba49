"""Numbers that Charan et al. 2020 print, where to look for them, and tolerances."""

UNSTABLE = 'Fig 2: supplement, "the system becomes unstable for all force values F_x > 0.082"'
FRONT_LOADS = (0.083, 0.087, 0.090)
STABLE_LOAD = 0.062
GROWTH_LOADS = (0.030, 0.040, 0.083, 0.087, 0.090)
V2_THRESHOLD = 0.05
LINE_TOP = 0.090  # largest load in the fit of Eq 10: that of the loads named in the paper
MODE_LOAD = 0.083  # load at which the y mode is shown: the smallest push at which the paper's array slides
COARSER = (5e-3, 2e-3, 1e-3)  # extra load steps; the difference from the last one is the error of a birth
BISECTED = 1e-6  # width to which births and deaths are bisected [F_x]
IM_LAMBDA = {0.083: 2.4e-4, 0.087: 7.7e-4, 0.090: 1.0e-3}
V1 = {0.083: 0.0014, 0.087: 0.0022, 0.090: 0.0028}
# growth of the mean M from the first to the last quarter of a run: beats of stable modes stay far below, pairs above
RISE = 10.0
SHOWS = {
    "Fig 2": ("complex pairs along the push", "late-pair-birth"),
    "Fig 3": ("M(t) at six pushes", "stable-msd-0.062"),
    "Fig 4": ("trajectory of a disk up to the Coulomb limit", "spiral-lifts-disks"),
    "Fig 5": ("fronts of breaching and of sliding", "v1-over-im-lambda"),
    "Fig 6": ("transverse mode", "y-mode-frequency"),
    "Fig 7": ("sliding velocity against push", "sliding-velocity-slope"),
}
TOLERANCE = {
    "pairs": 0.0,  # counts
    "window": 0.02,  # 0.082 and 0.062 are printed with two digits: more than half a unit of the last, 0.8 %
    "birth": 0.01,  # 0.082 is printed with two digits: half a unit of the last is 0.6 %
    "im-lambda": 0.1,  # printed with one or two digits: half a unit of the last is 5 % of 0.001
    "growth": 0.02,  # linear theory is exact; the fit window ends where contacts begin to open
    "saturation": 1.0,  # the paper says "about" and prints a power of ten: a factor of two either way
    "threshold": 0.1,  # the paper's loads of arrest and of sliding differ by a factor of two
    "front": 0.25,  # nearly three times the largest error that the paper gives for V_1 with its 25 realizations, 9 %
    "ratio": 1.5 / 4.3,  # the scatter that the paper prints: 4.3 ± 1.5
    "exponent": 0.21,  # over Im λ from 2.4e-4 to 1.0e-3, this change of the power equals the ratio's scatter of 35 %
    "slope": 0.1,  # printed with two digits and no error: typical of a fit to a handful of velocities
    "intercept": 0.2,  # as for the slope, but the intercept extrapolates over nine tenths of the push
    "share": 0.1,  # the figure shows no x and no rotation: bars of 0.3 would be visible, and their square is 0.1
    "frequency": 0.05,  # "approximately"; printed with three digits, at a push that is not stated
    "wave number": 0.25,  # "approximately 2": half a unit of the only digit of the wavelength
    "steady": 0.1,  # "fixed", "without growth": what a plot would show
    "power": 0.1,  # t and t^1.1 differ by a quarter over a decade
    "independence": 0.25,  # of an exponent: from 0.083 to 0.12 the speed then changes by a tenth
    "charging": 0.1,  # a smaller change of t_iw than this is none
    "closed form": 1e-6,  # exact; the relaxation ends at a residual of 1e-14
}
