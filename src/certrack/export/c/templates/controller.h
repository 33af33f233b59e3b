${introduction}
#ifndef ${guard}
#define ${guard}

typedef ${number} ${name}_real;

/* Time between two samples, s. */
#define ${name}_PERIOD ${period}

${inputs}
#define ${name}_STATES ${states}

/* The reference y_d and its derivatives up to order ${order}, when the sample is taken. */
#define ${name}_REFERENCES ${references}

/* What is kept from sample to sample. */
typedef struct {
${members}
} ${name}_state;
${parameters}
${functions}

#endif
