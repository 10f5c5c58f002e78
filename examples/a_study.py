"""One IMM, or the right filter of three? Forty runs of each target, and how sure that makes one."""

from imm_tdoa import study

# A study is a TOML file; `imm-tdoa study` lists those that ship.
plan = study.load("motion-form", runs=40)
store = study.run(plan, "motion-form")  # run again, it goes on where it was interrupted
found = study.collect(plan, store)  # an xarray Dataset

for scenario in found.scenario.values:
    one = found.sel(scenario=scenario)
    best = one.sel(bank=one.position_rmse.idxmin("bank"))
    low, high = float(best.position_rmse_low), float(best.position_rmse_high)
    print(f"{scenario:13} {best.bank.item():12} RMSE {low:4.0f} to {high:4.0f} m")

print(*study.conclude(found)[""], sep="\n")
study.write(found, plan, store, "motion-form")  # tables, results.nc, report.html
