"""Rate-and-state friction, without grains.

RateState, Spring, LoadStep     surface, spring, one step of the load point's motion
spring_slider, prescribed       friction of a slider under a load history, or at a prescribed slip velocity
velocity_steps, slide_hold_slide, stated_steps  load histories
load_steps, find_steps  load histories from a displacement, exact or noisy
steady_sliding, critical_stiffness  stability of steady sliding
fit, compare_laws, Data     fitted parameters with intervals; comparison of two laws
posterior       draws from the posterior distribution of a fit
LabRecord, read_record, record_columns, write_csv, record_data     laboratory records
steady_mean, steady_start, hold_response, healing   quantities measured from a record
Fault, line_fault, simulate_fault, Recording    earthquake cycles on a straight fault
FaultState, initial_state, perturbed_state, fault_dataset   state of a fault; its history as an xarray dataset
moment_magnitude        M_w from a seismic moment
Injection, Oscillation, StressTable, read_stress_table  changes of the normal stress on a fault in time
nucleation, nucleation_half_length, cohesive_length, critical_wavelength    lengths that determine stability
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
