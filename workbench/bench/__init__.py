"""From a generator, an oscilloscope and a resistor to a spectrum with its uncertainty, in a file that loses nothing.

    setup = read_bench(Path("BENCH.toml"))            # setup
    run = measure(setup, Path("RUN.h5"))              # sweep: one point after another, each on disk before the next
    compensation = read_compensation(setup.standards) # spectra: open, short and load
    level_spectra(run, setup, compensation)[0]        # spectra: the Spectrum, its uncertainty, its flags

A point is two waveforms (sine_fit), their ratio and the resistor (impedance), and the correction for the cable by open,
short and load (compensation). Waveforms saved by hand are read by waveforms.
"""
