# The commands of this project. `just` lists them.

set positional-arguments

# `uv run` takes an activated environment first; the recipes always mean this checkout's own.
export VIRTUAL_ENV := justfile_directory() / ".venv"

config := "config/sim.toml"
of_them := " and not thorough"    # which tests `test` runs

[private]
default:
    @just --list --unsorted

# Install what is missing (system libraries, Python packages)
setup:
    @./setup.sh

# Run one pick in the simulated cell; more arguments go to `cell start`
start *args: setup
    uv run cell start --config {{config}} --cycles 1 "$@"

# Start the simulated cell and leave it running, at real-time pace
[no-exit-message] # Ctrl-C is how it ends, and no error
sim *args: setup
    uv run cell start --config {{config}} --set sim.pace=1 "$@"

# Show three cycles of the simulated cell: one succeeds, one must fail, one asks what if; each with its page
tour *args: setup
    uv run cell tour "$@"

# Install what the tests of the real drivers need: the vendors' SDKs, and a simulator of the FR3 in its own environment
stand-ins: setup
    @./setup.sh stand-ins

# Run one pick of the lab's drivers against stand-ins of its devices; more arguments go to `cell start`
stand-in *args: stand-ins
    uv run python -m stand_ins.cell --cycles 1 "$@"

# Fetch the weights of the segmenter `salient` (U-2-Net small, 4.6 MB) into weights/
salient: setup
    @./setup.sh salient

# Install LeRobot into .venv-lerobot (8 GB), for the test that it opens an exported data set
lerobot: setup
    @./setup.sh lerobot

# Run the tests of the gate; more arguments go to pytest
test *args: setup
    @./setup.sh stand-ins || echo "test: tests of the real drivers that need the above will be skipped" >&2
    @./setup.sh salient || echo "test: tests with the weights of U-2-Net will be skipped" >&2
    # three files at a time, for many wait, in their order (those of whole cells, which take longest, are among the first);
    # then, alone, those at 1 kHz: there only the arm's own reflex (this machine was late) is tried again
    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 uv run pytest -m "not realtime{{of_them}}" -n 3 --dist loadgroup --no-loadscope-reorder "$@" || [ $? -eq 5 ]
    uv run pytest -m "realtime{{of_them}}" --reruns 2 --only-rerun ArmReflex "$@" || [ $? -eq 5 ]

# Run every test: those of the gate, and every row, object and seed of what it has one of
test-all *args:
    @{{just_executable()}} of_them="" test "$@"

# Run the tests of the gate on another Python, in an environment of its own: `just test-on 3.13`
test-on python *args: setup
    uv venv --quiet --allow-existing --python {{python}} .venv-{{python}}
    uv pip sync --quiet --python .venv-{{python}} --require-hashes requirements.lock
    uv pip install --quiet --python .venv-{{python}} --no-deps --no-build-isolation --editable .
    shift; OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv-{{python}}/bin/python -m pytest -m "not realtime{{of_them}}" -n 3 --dist loadgroup --no-loadscope-reorder "$@"

# Lint, format, types, import contracts
check: setup
    uv run ruff check .
    uv run ruff format --check .
    uv run mypy
    uv run lint-imports

# Run the benchmarks (JSON)
bench *args: setup
    uv run python -m benchmarks "$@"

# Run the pure stages of a recording again and compare
replay *args: setup
    uv run cell replay "$@"

# Write down anew what the pure stages decide on the golden recordings; review the diff
golden-update: setup
    uv run python -m tests.golden.behaviour
    git --no-pager diff --stat tests/golden

# Write the report page of a recording
report *args: setup
    uv run cell report "$@"

# Regenerate the pages that are written from the code, and build all pages as a site into site/ (warnings are errors)
docs: setup
    uv run python -m docs.commands_page
    uv run python -m docs.states_page
    uv run python -m docs.faults_page
    uv run python -m docs.bus_page
    uv run python -m docs.settings_page
    uv run python -m docs.recording_page
    uv run python -m docs.catalogue_page
    uv run python -m docs.export_page
    uv run python -m docs.opcua_page
    uv run python -m docs.api_page
    uv run python -m docs.plug_in_page
    NO_MKDOCS_2_WARNING=1 uv run mkdocs build --quiet

# Run the notebook docs/examples/first_pick.ipynb, and write what it gives
notebook: setup
    uv run python -m docs.notebook

# Draw the pictures of docs/first_hour.md, from a run of its own (needs a browser: chromium-headless-shell)
first-hour: setup
    uv run python -m docs.first_hour_pictures

# Draw the README's pictures, of a pick and of the operator's page, from real runs (needs a browser: chromium-headless-shell)
pictures: setup
    uv run cell start --config {{config}} --cycles 1 --seed 8 --no-report --set recording.folder=recordings/pictures
    uv run python -m docs.pick_picture recordings/pictures/*/*.mcap
    uv run python -m docs.page_picture

# Resolve the dependencies anew into requirements.lock
lock:
    uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-annotate --no-header \
        --fork-strategy fewest --python-version 3.11 --upgrade --extra dev pyproject.toml --output-file requirements.lock
    printf '%s\n' "pylibfranka>=0.21.3; python_version < '3.13'" franky-control "pyorbbecsdk2; python_version < '3.14'" | \
        uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-annotate --no-header \
        --python-version 3.11 --upgrade --constraint requirements.lock - --output-file requirements-hardware.lock
    echo franka-sim | uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-annotate --no-header \
        --python-version 3.11 --upgrade - --output-file stand_ins/franka_sim.lock
