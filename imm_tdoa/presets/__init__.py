"""Banks that ship with the package, one TOML file each; `imm_tdoa.bankfile.load` reads them."""
