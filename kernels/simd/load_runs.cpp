// Body of load_runs in memory.py; $lanes are the lanes, $each the numbers at their places.
const auto at = x.data;
run r;
if (node.c[0] < 0) {
    const run first = *runs(at + ~node.c[0]), second = *runs(at + node.c[1]);
    typedef decltype(first < second) places;
    r = places{$lanes} < places(node.c[2]) ? first : second;
} else
    r = run{$each};
return as_value(r);
