"""Makes the files beside it with the programs of libsvm (Debian: libsvm-tools): `python3 make.py`.

Five clusters in 12 of the 88 features; the other features are constant, so that svm-scale leaves them out. The first
label in the training data is 3, so libsvm's order of the classes is not 1 to 5. The second regressor's ratings are scaled too.
"""

import random
import subprocess

random.seed(7)
FEATURES, USED = 88, list(range(3, 88, 7))[:12]
CENTRES = {c: [random.gauss(0, 1) for _ in USED] for c in range(1, 6)}
UNITS = [10 ** random.uniform(-2, 3) for _ in USED]


def vector(label):
    values = [random.gauss(m, 0.8) * u + 5 * u for m, u in zip(CENTRES[label], UNITS)]
    return dict(zip(USED, values))


def write(name, rows):
    with open(name, "w") as out:
        for target, v in rows:
            words = [f"{i}:{v.get(i, 0.25):.9g}" for i in range(1, FEATURES + 1)]
            out.write(" ".join([f"{target:.9g}", *words]) + "\n")


def tool(command, to=None):
    out = subprocess.run(command.split(), check=True, capture_output=True, text=True).stdout
    if to:
        with open(to, "w") as file:
            file.write(out)


def rating(label, v):
    return 10 * label + 30 * abs(v[USED[label]] / UNITS[label] - 5)


LABELS = [3, 1, 5, 2, 4]
train = [(LABELS[n % 5], vector(LABELS[n % 5])) for n in range(60)]
test = [(label, vector(label)) for label in (1, 2, 3, 4, 5, 1, 4)]
write("train.tmp", train)
write("test.features", test)
tool("svm-scale -s class.range train.tmp", "train.scaled.tmp")
tool("svm-train -q -s 0 -t 2 -c 8 -g 0.1 -b 1 train.scaled.tmp class.model")
tool("svm-scale -r class.range test.features", "class.scaled")
tool("svm-predict -b 1 class.scaled class.model class.predicted")
for k in range(1, 6):
    rows = [(rating(k, v), v) for _, v in train]
    write("train.tmp", rows)
    y = "-y -1 1" if k == 2 else ""
    tool(f"svm-scale -l -1 -u {1 if k != 3 else 2} {y} -s reg{k}.range train.tmp", "train.scaled.tmp")
    kind = 4 if k == 4 else 3
    tool(f"svm-train -q -s {kind} -t 2 -c 64 -g 0.05 -p 0.2 train.scaled.tmp reg{k}.model")
    tool(f"svm-scale -r reg{k}.range test.features", f"reg{k}.scaled")
    tool(f"svm-predict reg{k}.scaled reg{k}.model reg{k}.predicted")
subprocess.run("rm -f *.tmp", shell=True, check=True)
