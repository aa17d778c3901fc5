// Body of step in stages.py.
run change = *runs(&rate), sum, more;
const run first = *runs(now.data + at);
const run second = *runs(past.data + at);
change *= tau;
change += first;
sum = change * weights.c[0];
more = first * weights.c[1];
sum += more;
more = second * weights.c[2];
sum += more;
$shift
*runs(out.data + at) = change;
*runs(mixed.data + at) = sum;
