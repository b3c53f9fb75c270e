"""`python -m sim_bridge.research.reference`: write the generated part of docs/reference."""

from sim_bridge.research.reference.write import ROOT, update_reference_files

if __name__ == "__main__":
    touched = update_reference_files()
    for path in touched:
        print(path.relative_to(ROOT))
    print(f"{len(touched)} files written or removed")
