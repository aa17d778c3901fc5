// Body of add_up in sums.py.
const long n = sums.shape[0], width = sums.shape[1];
int first[64], size[64];  // of the rows in front, whose sizes grow and then shrink
long rows = 0;
const auto merge = [&]() {
    double* to = sums.data + (rows - 2) * width;
    for (long k = 0; k < width; ++k) to[k] += to[width + k];
    --rows;
};
const auto are_halves = [&]() {
    const int at = rows - 2;
    return at >= 0 && size[at] == size[at + 1] && first[at] % (2 * size[at]) == 0;
};
for (long i = 0; i < n; ++i) {
    const double* from = sums.data + i * width;
    for (long k = 0; k < width; ++k) sums.data[rows * width + k] = from[k];
    first[rows] = nodes.data[2 * i];
    size[rows++] = nodes.data[2 * i + 1];
    for (; are_halves(); size[rows - 1] *= 2) merge();
}
while (whole && rows > 1) merge();
