// Body of load_runs in memory.py; $lanes are the lanes, $each the numbers at their places.
// The table: 0 to 3 places of runs less their first lanes, 4 to 6 first lanes, 7 number of runs.
const auto at = x.data;
const auto& of = table.c;
const int count = of[7];
run r;
if (count > 0) {
    r = *runs(at + of[0]);
    typedef decltype(r < r) each;
    const each lane{$lanes};
    if (count > 1)
        r = lane < each(of[4]) ? r : *runs(at + of[1]);
    if (count > 2) {
        r = lane < each(of[5]) ? r : *runs(at + of[2]);
        r = lane < each(of[6]) ? r : *runs(at + of[3]);
    }
} else {
    const auto& node = others.data[of[0]];
    r = run{$each};
}
return as_value(r);
