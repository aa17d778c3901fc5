// Body of add_products in sums.py; adjacent chunks of about `together` numbers in all are processed at a time.
typedef double eight __attribute__((ext_vector_type(8)));
typedef long long places __attribute__((ext_vector_type(8)));
struct one { enum { value = 1 }; };
struct two { enum { value = 2 }; };
struct three { enum { value = 3 }; };
struct four { enum { value = 4 }; };
const auto partial = reinterpret_cast<double*>(call.data[0]);
const long apart = call.data[1];
const auto first = call.data + 3, last = first + 3 * call.data[2];
const long n = weights.shape[0], chunks = spans.shape[1];
const auto all = [](const auto* x) {
    typedef __typeof__(*x + 0) number;
    typedef number run __attribute__((ext_vector_type(8), aligned(sizeof(number))));
    return __builtin_convertvector(*reinterpret_cast<const run*>(x), eight);
};
const auto front = [&](const auto* x, long i, long end) {
    eight r = 0;
    if (i + 8 <= n)
        r = places{0, 1, 2, 3, 4, 5, 6, 7} < places(end - i) ? all(x + i) : r;
    else
        for (long j = i; j < end; ++j) r[j - i] = x[j];
    return r;
};
typedef const number* numbers;
const auto add = [&](auto count, numbers row, numbers v, long i, long end, double* to) {
    eight p[count.value] = {};
    for (; i + 8 <= end; i += 8) {
        const eight x = all(weights.data + i) * all(v + i);
        for (long r = 0; r < count.value; ++r) p[r] += x * all(row + r * n + i);
    }
    if (i < end) {
        const eight x = front(weights.data, i, end) * front(v, i, end);
        for (long r = 0; r < count.value; ++r) p[r] += x * front(row + r * n, i, end);
    }
    for (long r = 0; r < count.value; ++r) {
        const auto q = p[r].lo + p[r].hi;
        to[r] += (q[0] + q[2]) + (q[1] + q[3]);
    }
};
const auto project = [&](const auto* each, long field, const int* at, double* to, long m) {
    auto row = reinterpret_cast<numbers>(each[0]);
    const auto v = reinterpret_cast<numbers>(each[1]);
    const auto rows = [&](auto count) {
        for (long c = 0; c < m; ++c)
            add(count, row, v, field + at[2 * c], field + at[2 * c + 1], to + c * apart);
    };
    long left = each[2];
    for (; left >= 4; left -= 4, row += 4 * n, to += 4) rows(four());
    if (left == 3) rows(three());
    if (left == 2) rows(two());
    if (left == 1) rows(one());
    return to + left;
};
long sums = 0;
for (auto each = first; each < last; each += 3) sums += each[2];
for (long c = 0; c < chunks; ++c)
    for (long s = 0; s < sums; ++s) partial[c * apart + s] = 0.0;
for (long field = 0; field < n; field += size)
    for (long k = 0; k < spans.shape[0]; ++k)
        for (long c = 0, behind; c < chunks; c = behind) {
            const int* at = spans.data + 2 * k * chunks;
            long taken = 0;
            for (behind = c; behind < chunks && taken < together; ++behind)
                taken += at[2 * behind + 1] - at[2 * behind];
            double* to = partial + c * apart;
            for (auto each = first; each < last; each += 3)
                to = project(each, field, at + 2 * c, to, behind - c);
        }
